"""The constants of a structured-light camera.

Axial noise grows with the square of the depth because disparity is what is measured; the deviation
of 0.0014 z^2 and the 1/8 pixel steps are those of Khoshelham and Elberink, "Accuracy and Resolution
of Kinect Depth Data" (Sensors 2012).
"""

RANGE_M = (0.4, 5.0)
"""Nearest and farthest depth that is measured."""

FOCAL_BASELINE = 43.5
"""Focal length (pixels) times baseline (metres)."""
STEP_PX = 0.125
"""Of disparity."""
NOISE_PX = 0.049
"""Deviation of disparity."""
