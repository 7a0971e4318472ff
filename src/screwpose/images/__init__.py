"""What did the detector see? (floor 1)"""

from screwpose.images.encoding import encode_png
from screwpose.images.field import field_of_view
from screwpose.images.polarity import Polarity, detect_polarity
from screwpose.images.preparation import background, flattened, log_image, smoothed
from screwpose.images.radiograph import Radiograph
from screwpose.images.reading import read_mask, read_radiograph

__all__ = [
    "Polarity",
    "Radiograph",
    "background",
    "detect_polarity",
    "encode_png",
    "field_of_view",
    "flattened",
    "log_image",
    "read_mask",
    "read_radiograph",
    "smoothed",
]
