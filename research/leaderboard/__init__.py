"""The leaderboard: entries, verification, page."""
