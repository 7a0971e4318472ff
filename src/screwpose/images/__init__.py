"""What did the detector see? (floor 1)"""

from screwpose.images.encoding import encode_png
from screwpose.images.field import field_of_view
from screwpose.images.polarity import Polarity, detect_polarity
from screwpose.images.preparation import background, carried_outwards, flattened, log_image, smoothed
from screwpose.images.radiograph import Radiograph
from screwpose.images.reading import read_mask, read_radiograph
from screwpose.images.target import metal_target

__all__ = [
    "Polarity",
    "Radiograph",
    "background",
    "carried_outwards",
    "detect_polarity",
    "encode_png",
    "field_of_view",
    "flattened",
    "log_image",
    "metal_target",
    "read_mask",
    "read_radiograph",
    "smoothed",
]
