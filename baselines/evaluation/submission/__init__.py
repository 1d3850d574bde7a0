"""Others can enter: what a policy did in a frozen suite as one small file, checked, run again, on the leaderboard."""
