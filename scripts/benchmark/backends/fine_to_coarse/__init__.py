"""Fine-to-Coarse (Halber and Funkhouser, CVPR 2017): global registration that uses scan order."""

from benchmark.backends.fine_to_coarse.registration import fine_to_coarse

__all__ = ["fine_to_coarse"]
