"""The live page, and screenshots for the documentation."""
