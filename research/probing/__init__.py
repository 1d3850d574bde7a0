"""What an agent knows: what can be read from its memory, how soon it adapts, and where its training ends."""
