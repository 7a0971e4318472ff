"""Pairing and 3D poses of pedicle screws from two calibrated C-arm X-rays and CAD models.

Research software: not a medical device, not for clinical use.
"""

__version__ = "0.1.0"
