"""Pairing and 3D poses of pedicle screws from two calibrated C-arm X-rays and CAD models.

Research software: not a medical device, not for clinical use.
"""

from screwpose._compiling import ensure_cache_folder

__version__ = "0.1.0"

ensure_cache_folder()
