"""What a residual is for: agents that correct and agents that command alone, when something fails."""
