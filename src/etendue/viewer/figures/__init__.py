"""Arrays that the 3-D view draws, in render space: meshes, paths, boxes of trees, points, radiosity."""
