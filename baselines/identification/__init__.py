"""The command behind `python -m auv_gym.identify`, its report, and how often its intervals hold what is true."""
