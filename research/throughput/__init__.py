"""The speed of the environments beside that of Gymnasium's Pendulum: `make bench`."""
