"""What users would pick today: pair estimators and multi-scan back-ends with standard settings."""
