"""Transfer to another simulator: unchanged policies on vehicles with six degrees of freedom."""
