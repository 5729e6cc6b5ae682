"""Learning with stable-baselines3: VecEnv adaptor, features, training, checkpoints, weights."""
