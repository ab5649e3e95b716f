"""File formats of other programs for arrays, meshes and matrices, independent of their meaning."""

from .arrays import save_arrays
from .errors import FormatError
from .gltf import GltfMesh, far_centre, read_texture_coordinates, write_gltf
from .meshes import write_mesh
from .netcdf import NetcdfFile, netcdf_library, netcdf_metadata, read_netcdf
from .view3d import view3d_lines

__all__ = [
    "FormatError",
    "GltfMesh",
    "NetcdfFile",
    "far_centre",
    "netcdf_library",
    "netcdf_metadata",
    "read_netcdf",
    "read_texture_coordinates",
    "save_arrays",
    "view3d_lines",
    "write_gltf",
    "write_mesh",
]
