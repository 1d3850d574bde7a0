"""The leaderboard: its entries, their verification, its page."""
