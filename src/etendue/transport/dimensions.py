"""The dimensions of a path sample: which component of which vertex each random number decides.

Vertex 0 is the sub-path's own end (the sensor or the light), vertex j >= 1 the j-th surface it hits.
"""

from __future__ import annotations

# Vertex 0 of a camera sub-path.
FILM = 0  #: 2 numbers: the point on the film
APERTURE = 2  #: 2 numbers
LENGTH = 4  #: 1 number: how many edges the path has, where that is drawn

# Vertex 0 of a light sub-path.
LIGHT_PICK = 0
LIGHT_POINT = 1  #: 2 numbers: point on an area light, or on the scene's disc
LIGHT_DIRECTION = 3  #: 2 numbers

# Vertices j >= 1 of either.
LOBE = 0
DIRECTION = 1  #: 2 numbers
ROULETTE = 3
SPLAT_APERTURE = 4  #: 2 numbers, light sub-paths only
SPLAT_FILTER = 6  #: 2 numbers, light sub-paths only

#: 1 number, light sub-paths only: roulette before a splat's shadow ray.
SPLAT_SHADOW = 8

#: 1 number, camera sub-paths only: whether the guide is asked for the direction.
GUIDE = 4

# Camera sub-paths, from here: 4 numbers for each next-event sample (pick, point, roulette), then 1 for each connection
# (roulette; the pick comes from a source that blocks of lanes share).
NEXT_EVENT = 8
NEXT_EVENT_MAX = 8
CONNECT = NEXT_EVENT + 4 * NEXT_EVENT_MAX
CONNECT_MAX = 16
