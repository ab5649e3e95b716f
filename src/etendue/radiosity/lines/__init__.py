"""Lines through a scene, and the segments they are reduced to: generators, engines, sums."""
