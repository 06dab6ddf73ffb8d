"""From a candidate pose to a refined pose and the evidence for it (Sec. 3.3)."""
