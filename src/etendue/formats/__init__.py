"""File formats of other programs for arrays, meshes and matrices, independent of their meaning."""

from .arrays import save_arrays as save_arrays
from .elmer import elmer_lines as elmer_lines
from .energyplus import (
    Zone as Zone,
    check_idf_names as check_idf_names,
    energyplus_json as energyplus_json,
    energyplus_lines as energyplus_lines,
)
from .errors import FormatError as FormatError
from .gltf import (
    GltfMesh as GltfMesh,
    far_centre as far_centre,
    read_texture_coordinates as read_texture_coordinates,
    write_gltf as write_gltf,
)
from .meshes import write_mesh as write_mesh
from .moose import check_moose_names as check_moose_names, moose_lines as moose_lines
from .netcdf import (
    NetcdfFile as NetcdfFile,
    netcdf_library as netcdf_library,
    netcdf_metadata as netcdf_metadata,
    read_netcdf as read_netcdf,
)
from .openfoam import (
    openfoam_face_lines as openfoam_face_lines,
    openfoam_factor_lines as openfoam_factor_lines,
)
from .tables import table_lines as table_lines
from .udales import (
    udales_lines as udales_lines,
    udales_sky_lines as udales_sky_lines,
    write_udales_netcdf as write_udales_netcdf,
)
from .view3d import read_view3d as read_view3d, view3d_lines as view3d_lines
