"""Evaluation: policies through scenarios with paired seeds, metrics, report, and the reproduction of the paper."""
