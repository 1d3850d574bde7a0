"""Lower bounds of the error: the full-information optimum and the estimation lower bound."""
