"""The speed of the environments beside that of Gymnasium's own: `make bench`."""
