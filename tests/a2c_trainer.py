"""Another algorithm in one file: A2C of stable-baselines3. In YAML: ``kind: "a2c_trainer:A2CTrainer"``."""

from pydantic import Field
from stable_baselines3 import A2C

from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import training_logger
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_env import ConfigurationError
from hydro_env.files import Group


class A2CSettings(Group):
    total_steps: int = Field(100_000, ge=1)
    axes: int = Field(64, ge=1)
    learning_rate: float = Field(7e-4, gt=0.0, le=1.0)


class A2CTrainer:
    settings = A2CSettings

    def train(self, config, settings, *, seed, folder, resume, base, progress):
        if resume:
            raise ConfigurationError("a2c: cannot resume")
        env = AxisVecEnv(config, settings.axes, PolicyFeatures(config, base), seed)
        model = A2C("MlpPolicy", env, settings.learning_rate, seed=seed, device="cpu")
        model.set_logger(training_logger(folder))
        model.learn(settings.total_steps)
        return PolicyController.from_sb3(model)

    def load(self, path):
        return PolicyController.load(path)
