"""The compiled lower bound of `engine_rivals.LowerBound`."""

from numba import njit

from screwpose.projection.kernels import project, set_run


@njit(nogil=True, error_model="numpy")
def write_bits(pixels_from_world, world_from_cad, vertices_mm, starts, u, v, runs, bits):
    for scene in range(world_from_cad.shape[0]):
        for body in range(world_from_cad.shape[1]):
            first, last = starts[body], starts[body + 1]
            pixels_from_cad = pixels_from_world @ world_from_cad[scene, body]
            project(pixels_from_cad, vertices_mm[first:last], u[first:last], v[first:last])
        for run in range(runs.shape[0]):
            set_run(bits, runs[run, 0], runs[run, 1], runs[run, 2])
