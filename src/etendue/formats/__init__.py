"""File formats of other programs for arrays, meshes and matrices, independent of their meaning."""

from .arrays import save_arrays as save_arrays
from .errors import FormatError as FormatError
from .gltf import (
    GltfMesh as GltfMesh,
    far_centre as far_centre,
    read_texture_coordinates as read_texture_coordinates,
    write_gltf as write_gltf,
)
from .meshes import write_mesh as write_mesh
from .netcdf import (
    NetcdfFile as NetcdfFile,
    netcdf_library as netcdf_library,
    netcdf_metadata as netcdf_metadata,
    read_netcdf as read_netcdf,
)
from .view3d import view3d_lines as view3d_lines
