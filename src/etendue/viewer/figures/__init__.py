"""What the 3-D view draws, as arrays in render space: meshes, paths, boxes of trees, points, radiosity."""
