"""Training: adapters to the libraries that learn."""
