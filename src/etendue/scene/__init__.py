"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, étendue's Mitsuba plugins."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from . import graph as graph, meshes as meshes
    from .bands import Bands as Bands, band_names as band_names, require_colours as require_colours
    from .bounds import centre_of as centre_of, corners_of as corners_of
    from .builtin.table import BundledScene as BundledScene, bundled as bundled, bundled_scene as bundled_scene
    from .camera import MOVABLE as MOVABLE, Camera as Camera, described_sensor as described_sensor
    from .capability import check as check, is_dark as is_dark, one_way as one_way, refuse_one_way as refuse_one_way
    from .changes.edits import ParameterChanges as ParameterChanges, name_elements as name_elements
    from .changes.parameters import SceneEditor as SceneEditor, SceneParameter as SceneParameter
    from .changes.watching import Parameters as Parameters, parameters as parameters, view as view
    from .editing import (
        LightEdits as LightEdits,
        colour as colour,
        described_lights as described_lights,
        is_described as is_described,
        scene_xml as scene_xml,
    )
    from .fingerprints import fingerprint as fingerprint
    from .graph import materials as materials
    from .immersion import check_media as check_media, media_in as media_in, medium_at as medium_at
    from .lamps.placement import (
        lamps_in_surfaces as lamps_in_surfaces,
        remarks_on as remarks_on,
        warn_of_lamps as warn_of_lamps,
    )
    from .lamps.places import LightsAt as LightsAt
    from .lamps.radiance import (
        front as front,
        has_cells as has_cells,
        is_smooth as is_smooth,
        sphere_point as sphere_point,
        sphere_point_facing as sphere_point_facing,
        surface_point as surface_point,
        uniform_point as uniform_point,
    )
    from .lamps.rays import own_ray as own_ray
    from .lamps.table import Light as Light, LightTable as LightTable
    from .loading import (
        Source as Source,
        colours_of as colours_of,
        described as described,
        integrator_of as integrator_of,
        load as load,
        locate as locate,
        use_variant_of as use_variant_of,
    )
    from .media import (
        Media as Media,
        is_phase as is_phase,
        media_of as media_of,
        medium_behind as medium_behind,
        refuse_media as refuse_media,
        scatters as scatters,
    )
    from .members import (
        Material as Material,
        Members as Members,
        bsdfs as bsdfs,
        emitters as emitters,
        measured_on as measured_on,
    )
    from .meshes import box as box, joined as joined
    from .meters import METER_OFFSET as METER_OFFSET, least_offset as least_offset, with_meters as with_meters
    from .models.reading import emits as emits, is_model as is_model
    from .packet import (
        DISPERSES as DISPERSES,
        LEAST_WHITE as LEAST_WHITE,
        Packet as Packet,
        brightness as brightness,
        entry as entry,
        hero_alone as hero_alone,
        is_rgb as is_rgb,
        is_spectral as is_spectral,
        require_rgb as require_rgb,
        spread_wavelengths as spread_wavelengths,
    )
    from .parsing import Change as Change, is_sensor as is_sensor
    from .parts import load_part as load_part, shape_boxes as shape_boxes, unmerged as unmerged
    from .plugins import register as register
    from .plugins.composed import composed_bsdf as composed_bsdf
    from .portables import PortableScene as PortableScene, portable as portable, restored as restored
    from .problem import Problem as Problem
    from .resizing import resized as resized
    from .source import SceneSource as SceneSource, found as found, placed as placed
    from .space import RenderSpace as RenderSpace, warn_of_offsets as warn_of_offsets, warn_of_steps as warn_of_steps
else:
    __getattr__, __dir__ = on_use(__name__)
