"""The potential of scans that stand together: samples, fit, what is told of it."""
