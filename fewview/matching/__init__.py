"""From two completed scans to K rigid poses: correspondences, consistency, spectral sets."""
