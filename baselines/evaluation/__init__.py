"""Evaluation of policies on paired episodes: metrics, scores, report, frozen suites and files of results."""
