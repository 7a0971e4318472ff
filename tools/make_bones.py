"""Make the table of bones that the simulator's patients are bent from: src/screwpose/simulation/tables/bones.npz.

    python tools/make_bones.py

To be run when `screwpose.simulation.spine_shapes` or the pelvis in `screwpose.simulation.ribs` changes; all simulated
images change with it, so benchmark sets need a new version.
"""

from rich.console import Console

from screwpose.simulation.anatomy_bones import TABLE, write_bones
from screwpose.simulation.ribs import made_pelvis
from screwpose.simulation.spine import MADE_LEVELS
from screwpose.simulation.spine_shapes import LEVEL_NAMES, made_bone

if __name__ == "__main__":
    bones = {LEVEL_NAMES[index]: made_bone(index) for index in MADE_LEVELS}
    write_bones({**bones, "pelvis": made_pelvis()})
    Console().print(f"{TABLE.name}: {TABLE.stat().st_size / 1000:.0f} kB")
