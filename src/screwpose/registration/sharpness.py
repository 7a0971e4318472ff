"""How blurred are the X-rays? Models are compared with sharp images as these show edges, not as edges are.

The head of a screw tells its turn by slots that are a millimetre wide. Where an X-ray is softer than its model, another
turn imitates the softer edge of a slot that is seen from its side, and the fit goes there.
"""

from collections.abc import Sequence

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.registration.thickness_fit import Body, packed
from screwpose.similarity.assessment import assess
from screwpose.similarity.thickness import GradientTarget

# Variances, px^2, in equal steps, so that a parabola through three of them finds the best.
_TRIED_PX2 = np.arange(0.0, 4.81, 0.6)
# So much every detector's pixels blur: with models as soft as that, development cases were not better but for rolls of
# softer images, and their tips a tenth worse.
_LEFT_PX2 = 0.3


def as_imaged(
    views: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> list[GradientTarget]:
    """The views, each of which blurs the models by what makes them explain most at some poses.

    Parameters
    ----------
    poses : (4, 4) each, registered to about a pixel.
    """

    def of_view(view: GradientTarget) -> GradientTarget:
        together = packed(bodies, view.scale)
        energies: list[float] = []
        for more_px2 in _TRIED_PX2:
            energies.append(assess(view.blurring(float(np.sqrt(more_px2))), together, poses).energy)
            if len(energies) > 1 and energies[-1] < energies[-2]:  # they have one peak
                break
        return view.blurring(float(np.sqrt(max(0.0, _best_px2(np.array(energies)) - _LEFT_PX2))))

    return in_threads(of_view, views)


def _best_px2(energies: FloatArray) -> float:
    """Where a parabola through the largest of them and its neighbours is highest."""
    middle = int(np.argmax(energies))
    if middle in (0, len(energies) - 1):
        return float(_TRIED_PX2[middle])
    before, best, after = energies[middle - 1 : middle + 2]
    step = float(_TRIED_PX2[1] - _TRIED_PX2[0])
    return float(_TRIED_PX2[middle] + 0.5 * step * (before - after) / (before - 2.0 * best + after))
