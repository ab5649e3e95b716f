"""Calls of the objects of a scene."""

import drjit as dr
import mitsuba as mi
import numpy as np
from support.scenes import rgb

from etendue.scene.members import Members


def test_a_function_may_be_the_same_for_one_object_and_among_several():
    # LLVM refused the kernel, and the process aborted: a room with a lamp under an even sky.
    sky = {"type": "constant", "radiance": rgb(4, 5, 6)}
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": rgb(1, 2, 3)}}
    scene = mi.load_dict({"type": "scene", "sky": sky, "lamp": lamp})
    si = dr.zeros(mi.SurfaceInteraction3f, 8)
    si.wi = mi.Vector3f(0, 0, 1)
    lanes, number = dr.arange(mi.UInt32, 8), dr.reinterpret_array(mi.UInt32, scene.emitters_dr())

    def radiance(count):
        members = Members(mi.EmitterPtr, np.array(number)[:count], range(count))
        key = lanes % dr.opaque(mi.UInt32, count)
        return members.call(key, lambda emitter, si, active: emitter.eval(si, active), si, active=mi.Bool(True))

    one, both = radiance(1), radiance(2)
    dr.eval(one, both)  # in one kernel
    first = [[4, 5, 6] if e.is_environment() else [1, 2, 3] for e in scene.emitters()]
    np.testing.assert_allclose(np.array(both).T, [first[k % 2] for k in range(8)], rtol=1e-6)
    np.testing.assert_allclose(np.array(one).T, [first[0]] * 8, rtol=1e-6)
