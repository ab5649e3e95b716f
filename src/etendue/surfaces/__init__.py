"""Surfaces: patches and faces, read from meshes and scenes; ray casting; values and lightmaps on surfaces."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from etendue.scene import box as box, joined as joined

    from .ambient import (
        AMBIENT_TERMS as AMBIENT_TERMS,
        AmbientTerm as AmbientTerm,
        class_factors as class_factors,
        class_light as class_light,
        class_weights as class_weights,
        incoming as incoming,
    )
    from .coincident import (
        REACH_OF_PAIRS as REACH_OF_PAIRS,
        Coincident as Coincident,
        box_tree as box_tree,
        is_interior as is_interior,
        surfaces_of as surfaces_of,
    )
    from .diagnosis import MeshDiagnosis as MeshDiagnosis, diagnose as diagnose
    from .errors import PatchError as PatchError, SurfaceError as SurfaceError
    from .faces import face_vectors as face_vectors, named_faces as named_faces, triangles as triangles
    from .heat import (
        STEFAN_BOLTZMANN as STEFAN_BOLTZMANN,
        band_emission as band_emission,
        band_shares as band_shares,
        thermal as thermal,
    )
    from .lightmaps.atlases import (
        LIGHTMAP_MESHES as LIGHTMAP_MESHES,
        TexturedMesh as TexturedMesh,
        atlas as atlas,
        gltf_mesh as gltf_mesh,
        save_textured_mesh as save_textured_mesh,
        scene_mesh as scene_mesh,
    )
    from .lightmaps.colours import shown_exposure as shown_exposure, vertex_colours as vertex_colours
    from .lightmaps.textures import (
        Lightmap as Lightmap,
        check_coordinates as check_coordinates,
        lightmap_from as lightmap_from,
        lightmap_of as lightmap_of,
        save_lightmap as save_lightmap,
    )
    from .maps.cells import HistogramBuilder as HistogramBuilder, PatchMap as PatchMap
    from .maps.files import (
        check_place as check_place,
        read_map as read_map,
        save_map as save_map,
        solution_map as solution_map,
    )
    from .maps.kernels import KernelBuilder as KernelBuilder, variable_bandwidths as variable_bandwidths
    from .maps.nearest import PARTICLE_BYTES as PARTICLE_BYTES, NearestMap as NearestMap
    from .maps.places import MapSurfaces as MapSurfaces
    from .maps.protocol import (
        Irradiance as Irradiance,
        SurfaceMap as SurfaceMap,
        SurfaceParticles as SurfaceParticles,
        irradiance_at as irradiance_at,
    )
    from .maps.widths import rule_bandwidths as rule_bandwidths
    from .objects import Objects as Objects, find_objects as find_objects
    from .orienting import Orientation as Orientation, orientation as orientation
    from .patches import Patches as Patches
    from .patchfiles import check_patch_file as check_patch_file, save_patches as save_patches
    from .periods import LEAST_SLOPE as LEAST_SLOPE, endless_faces as endless_faces
    from .places import PatchSurfaces as PatchSurfaces, Place as Place, SurfaceValues as SurfaceValues
    from .rays.raycasting import STEP as STEP, Hits as Hits, RayScene as RayScene
    from .rays.sides import Sides as Sides, across as across, around as around, cosine_law as cosine_law
    from .rays.sources import (
        BATCH as BATCH,
        Places as Places,
        RaySource as RaySource,
        columns as columns,
        cosine_lanes as cosine_lanes,
        even_lanes as even_lanes,
        pairs_of as pairs_of,
    )
    from .readers.meshfiles import (
        is_mesh_file as is_mesh_file,
        may_have_zones as may_have_zones,
        read_patches as read_patches,
    )
    from .readers.sceneparts import has_instances as has_instances, scene_parts as scene_parts
    from .readers.scenepatches import lamps_apart as lamps_apart, scene_patches as scene_patches
    from .readers.tessellation import shape_triangles as shape_triangles
    from .savedpatches import differences as differences, saved_patches as saved_patches
    from .smoothing import (
        VertexRadiosity as VertexRadiosity,
        face_sides as face_sides,
        vertex_radiosity as vertex_radiosity,
    )
    from .spheres import bounding_sphere as bounding_sphere, joint_sphere as joint_sphere
    from .zones import zone_names as zone_names, zone_parts as zone_parts
else:
    __getattr__, __dir__ = on_use(__name__)
