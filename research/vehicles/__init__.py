"""Gains, fine-tuning and identification on published vehicles."""
