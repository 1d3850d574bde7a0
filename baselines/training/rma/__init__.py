"""Rapid motor adaptation."""
