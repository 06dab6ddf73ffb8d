"""The yardstick: scenes with ground truth, every method behind one signature, tables of both."""
