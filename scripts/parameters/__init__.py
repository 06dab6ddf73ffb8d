"""Phase two of the paper's training: what ties the modules together (Sec. 3.4, l_3 and l_4)."""
