"""Submissions to the leaderboard: the results of a policy on a frozen suite as one file, and their verification."""
