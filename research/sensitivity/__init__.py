"""How sensitive policies are: to changes in mid-run, to values outside of their training, to errors of their model."""
