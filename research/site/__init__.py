"""Pictures and pages of the documentation that need a browser."""
