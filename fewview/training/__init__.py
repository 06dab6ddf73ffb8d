"""Training of the completion networks: phase one of Sec. 3.4, each network alone."""
