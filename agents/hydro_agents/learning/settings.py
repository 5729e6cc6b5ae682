"""Settings of the trainers."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field

from hydro_env.files import Group, whole_group
from hydro_env.task.law import RigLaw
from hydro_env.units import Whole

LARGEST_ROLLOUT = 10_000_000  # largest number of samples of a rollout; it takes some gigabytes of memory


class PPOSettings(Group):
    """Settings of PPO; ``configs/agents/ppo.yaml`` holds those of the studies.

    In the residual form the reward of an axis is that above its twin's under the corrected controller.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    residual: bool = Field(True, description="true: the policy corrects another controller; false: it acts on its own")
    residual_scale: float = Field(0.2, gt=0.0, le=2.0, description="command per 1 of the policy's output")
    applied_share: float = Field(1.0, gt=0.0, le=1.0, description="of the correction, after the training: more margin")
    full_preview: bool = Field(False, description="the policy sees every sample of the preview, some from memory")
    see_estimates: bool = Field(
        False, description="the policy sees the estimates of the controller that it corrects; on its own, slow averages"
    )
    normalise: bool = Field(False, description="divide inputs by their typical sizes on training plants")
    family_units: Literal[False, True, "sensor"] = Field(
        False,
        description="reward relative to the mean error in the family of the reference, of the corrected controller, or "
        "of the policy with which a training without residual starts: true: of the true position; sensor: of the "
        "position with its sensor's bias",
    )
    reversal_price: float = Field(0.0, ge=0.0, le=1e6, description="on the smaller swing at a reversal, per 10 V")
    practice: dict[str, Any] = Field({}, description="fields of the task with other values in training")
    law: RigLaw | None = Field(None, description="rigs of the training, for any axis; none: the task's own")
    rigs_together: int | None = Field(
        None, ge=1, description="of the law that train at the same time; each gives way to the next one; null: all"
    )
    start: str | None = Field(None, description="path of weights of the same inputs and layers to begin with")
    teacher: str | None = Field(
        None,
        description="controller that a policy without residual imitates first: shipped, module:attribute, or weights; "
        "of a law with gains for any rig",
    )
    imitated_share: float = Field(0.5, gt=0.0, le=1.0, description="part of the training in which it imitates")
    imitation_rate: float = Field(1e-3, gt=0.0, le=1.0, description="learning rate then; falls to a hundredth")
    critic_first: float = Field(0.0, ge=0.0, lt=1.0, description="part in which the critic alone learns, after a start")
    reward_scale: float = Field(0.2, gt=0.0, le=1e6)
    total_steps: int = Field(8_000_000, ge=1, le=10**12, description="control periods, all axes together")
    axes: int = Field(256, ge=1, le=65_536)
    hidden_sizes: tuple[Annotated[Whole, Field(ge=1, le=4096)], ...] = Field((128, 128), min_length=1, max_length=16)
    lstm_cells: int | None = Field(
        None,
        ge=1,
        le=4096,
        description="of a recurrent layer (RecurrentPPO of sb3-contrib), which replaces the history; null: none",
    )
    activation: Literal["tanh", "relu"] = Field("relu", description="of the hidden layers; relu takes less time")
    discount: float = Field(0.98, gt=0.0, lt=1.0, description="per step of the rig: 1/1.54 of its pace")
    validation_every: int = Field(1_000_000, ge=0, description="steps between validations; 0: none")
    steps_per_rollout: int = Field(64, ge=2, le=1_000_000, description="control periods per axis between updates")
    minibatches: int = Field(4, ge=1)
    epochs: int = Field(4, ge=1, le=1000)
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="at the start; decreases to a tenth along a cosine")
    advantage_decay: float = Field(0.95, gt=0.0, le=1.0, description="λ of generalised advantage estimation")
    clip_range: float = Field(0.2, gt=0.0, le=10.0)
    initial_log_standard_deviation: float = Field(-1.5, ge=-10.0, le=2.0, description="of the exploration")
    final_log_standard_deviation: float = Field(
        -3.0, ge=-10.0, le=2.0, description="end of a linear schedule; the gradient alone would reduce it too early"
    )

    @whole_group
    def _of_a_correction(self) -> Self:
        if self.family_units and not self.residual and self.teacher is None:
            raise ValueError("family_units: needs residual: true or a teacher, whose errors are the units")
        if self.teacher is not None and self.residual:
            raise ValueError("teacher: needs residual: false, a policy that acts on its own")
        if self.law is not None:
            if self.law.split == "test":
                raise ValueError("law.split = test: nobody trains on test rigs; allowed: training, validation")
            if not self.normalise or not (self.residual or self.teacher):
                raise ValueError("law: needs normalise: true, and residual: true or a teacher")
            if self.together > self.law.count:
                raise ValueError(f"rigs_together = {self.together}: must not exceed law.count = {self.law.count}")
            if self.axes % self.together:
                what = "law.count" if self.rigs_together is None else "rigs_together"
                raise ValueError(f"axes = {self.axes}: must be a multiple of {what} = {self.together}")
        return self

    @whole_group
    def _batches(self) -> PPOSettings:
        rollout = self.axes * self.steps_per_rollout
        if rollout > LARGEST_ROLLOUT:
            raise ValueError(f"axes × steps_per_rollout = {rollout} must not exceed {LARGEST_ROLLOUT}")
        if rollout % self.minibatches or rollout // self.minibatches < 2:
            raise ValueError(
                f"minibatches = {self.minibatches} must divide axes × steps_per_rollout = {rollout} "
                "into parts of at least 2"
            )
        return self

    @property
    def together(self) -> int:
        """Number of rigs that train at the same time."""
        return self.rigs_together or (self.law.count if self.law else 1)

    def first_rig_at(self, share: float) -> int:
        """Number of the oldest rig when a share (0 to 1) of the training is done."""
        return int(share * (self.law.count - self.together)) if self.law else 0

    def learning_rate_at(self, remaining: float) -> float:
        """Learning rate when the share ``remaining`` of the training (1 to 0) is left."""
        share = min(1.0 - remaining, 1.0)  # the last rollout may exceed the end
        first, last, begins = self.learning_rate, 0.1, self.imitated_share if self.teacher else 0.0
        if share < begins:
            first, last, share = self.imitation_rate, 0.01, share / begins
        elif begins < 1.0:
            share = (share - begins) / (1.0 - begins)
        return first * (last + (1.0 - last) * 0.5 * (1.0 + math.cos(math.pi * share)))

    def log_standard_deviation_at(self, share: float) -> float:
        """Logarithm of the exploration's standard deviation when a share (0 to 1) of the training is done."""
        first, last = self.initial_log_standard_deviation, self.final_log_standard_deviation
        return first + (last - first) * share
