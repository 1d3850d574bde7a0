"""Controllers in space, each made of its form in the plane."""
