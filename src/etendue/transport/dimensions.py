"""The dimensions of a path sample: each random number is a component of a vertex.

Vertex 0 is the start of the sub-path (the sensor or the light), vertex j >= 1 the j-th surface that it hits.
"""

from __future__ import annotations

from etendue.points import Coordinates

# Vertex 0 of a camera sub-path.
FILM = 0  #: 2 numbers: point on the film
APERTURE = 2  #: 2 numbers: point on the aperture
LENGTH = 4  #: 1 number: edges of the path, for methods that sample this number
TECHNIQUE = 5  #: 1 number: technique of a path of these edges, for methods that sample it

#: 1 number, vertex 0 of either sub-path: wavelengths of a path, for methods whose paths have their own.
WAVELENGTHS = 9

# Vertex 0 of a light sub-path.
LIGHT_PICK = 0  #: 1 number: the light
LIGHT_POINT = 1  #: 2 numbers: point on an area light, or on the disc of rays from an infinite light
LIGHT_DIRECTION = 3  #: 2 numbers
LIGHT_GUIDE = 5  #: 1 number: whether the direction, or the place of the ray, is sampled from a learned density
LIGHT_CELL = 6  #: 2 numbers: cell of a learned place of a ray from an infinite light, and its third coordinate there

# Vertices j >= 1 of both.
LOBE = 0  #: 1 number: component of the BSDF
DIRECTION = 1  #: 2 numbers
ROULETTE = 3  #: 1 number
SPLAT_APERTURE = 4  #: 2 numbers, light sub-paths only
SPLAT_FILTER = 6  #: 2 numbers, light sub-paths only

#: 1 number, light sub-paths only: roulette before a splat's shadow ray.
SPLAT_SHADOW = 8

#: 1 number, light sub-paths only: whether the vertex is merged, if not all are.
MERGED = 9

#: 2 numbers, camera sub-paths only: whether a line to the light hit, and to the light point, is kept.
KEEP = 5

# Camera sub-paths: 4 numbers for each next-event sample (light, point, roulette), then 1 for each connection (roulette;
# the light vertex is picked by numbers of another source, which blocks of lanes share).
NEXT_EVENT = 8
NEXT_EVENT_MAX = 8
CONNECT = NEXT_EVENT + 4 * NEXT_EVENT_MAX
CONNECT_MAX = 16

# The edge that leads to vertex j >= 1, and the one that leaves vertex j >= 0, in media that scatter, of both sub-paths.
FREE_PATH = CONNECT + CONNECT_MAX  #: 1 number: distance to a collision
CHANNEL = FREE_PATH + 1  #: 1 number: colour channel by which distances are sampled
NULL_COLLISIONS = FREE_PATH + 2  #: 1 number: with that of the free path, selects those of null collisions

#: 1 number for each next-event sample, camera sub-paths only: whether its direction to a sky passes a window, and where
#: across it. Half of them are numbers that only light sub-paths, or walks without windows, use for something else.
WINDOW = (4, 5, 6, 7, *range(NULL_COLLISIONS + 1, NULL_COLLISIONS + 5))

# Coordinates of Halton's sequence: small primes for film and lens, larger primes from vertex to vertex, with next event
# before the direction. The first 46 primes (up to 199) cover 8 vertices. Other numbers are independent.
_LATER = {NEXT_EVENT: 0, NEXT_EVENT + 1: 1, NEXT_EVENT + 2: 2, DIRECTION: 3, DIRECTION + 1: 4}
CAMERA_COORDINATES = Coordinates({c: c for c in range(6)}, _LATER, 5, 46)
LIGHT_COORDINATES = Coordinates({c: c for c in range(5)}, {DIRECTION: 0, DIRECTION + 1: 1}, 2, 21)
