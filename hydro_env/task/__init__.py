"""The task of the axis: references, sensors, leakage, randomisation, reward, end of an episode."""
