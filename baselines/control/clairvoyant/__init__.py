"""The clairvoyant optimum: what the best commands give to whom plant, sea, lag, limits and start are known."""
