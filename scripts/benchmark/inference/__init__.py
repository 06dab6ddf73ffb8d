"""Ways to solve the discrete problem of the global stage, one small module each."""
