"""The estimation lower bound: a lower bound of the error of policies that estimate the position from measurements."""
