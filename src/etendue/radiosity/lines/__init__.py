"""Lines through a scene and their segments: generators, engines, sums."""
