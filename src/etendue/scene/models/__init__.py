"""Model files as scenes: OBJ with MTL, glTF, PLY, STL and OFF, read by trimesh."""
