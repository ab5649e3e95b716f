"""Light transport for all methods: vertices, walks, emission, camera, scattering, MIS weights, vertex stores."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from . import dimensions as dimensions
    from .alpha import coverage as coverage
    from .bidirectional.cache import PICK_BLOCK as PICK_BLOCK, LightCache as LightCache
    from .bidirectional.camera_walk import CameraWalk as CameraWalk
    from .bidirectional.kinds import WIDE as WIDE, Kind as Kind
    from .bidirectional.light_walk import LightPath as LightPath, LightWalk as LightWalk
    from .bidirectional.linear import Counts as Counts
    from .bidirectional.mis import GRAZING as GRAZING, Mis as Mis
    from .bidirectional.moments import TILE as TILE, Candidate as Candidate, Moments as Moments
    from .bidirectional.photons import (
        Gather as Gather,
        Photon as Photon,
        Photons as Photons,
        weigh as weigh,
    )
    from .bidirectional.pyramid import PYRAMID_MAX as PYRAMID_MAX, Pyramid as Pyramid
    from .bidirectional.single import SingleContribution as SingleContribution, SingleTechnique as SingleTechnique
    from .bidirectional.sinks import (
        CameraSink as CameraSink,
        Contribution as Contribution,
        Sink as Sink,
        SplatSink as SplatSink,
    )
    from .bidirectional.techniques import Techniques as Techniques
    from .bidirectional.vertices import (
        LightVertex as LightVertex,
        LightVertices as LightVertices,
        needs_interaction as needs_interaction,
    )
    from .camera import (
        CameraConnection as CameraConnection,
        CameraSampler as CameraSampler,
        SplatPlace as SplatPlace,
        Splats as Splats,
    )
    from .direct import DirectWeights as DirectWeights
    from .emission import (
        DirectSample as DirectSample,
        EmittedRay as EmittedRay,
        emission_of_hit as emission_of_hit,
        emit as emit,
        is_emissive as is_emissive,
        sample_direct as sample_direct,
        seen_through as seen_through,
    )
    from .endings.ambient import (
        AMBIENT_WALKS as AMBIENT_WALKS,
        AmbientScene as AmbientScene,
        AmbientTable as AmbientTable,
        ambient_scene as ambient_scene,
    )
    from .endings.maps import (
        EndingGuidedWalk as EndingGuidedWalk,
        EndingInIndirect as EndingInIndirect,
        EndingWalker as EndingWalker,
        light_of_map as light_of_map,
    )
    from .firsthits import FirstHits as FirstHits, seen_shapes as seen_shapes
    from .flight import Passing as Passing
    from .functions import TransportFunctions as TransportFunctions, film_picture as film_picture
    from .guiding.connections import (
        CLASSES as CLASSES,
        ConnectionGuide as ConnectionGuide,
        ConnectionSums as ConnectionSums,
    )
    from .guiding.emission import (
        EmissionGuide as EmissionGuide,
    )
    from .guiding.guide import (
        FITS as FITS,
        NOWHERE as NOWHERE,
        Guide as Guide,
        GuidedScattered as GuidedScattered,
        direction_of as direction_of,
        square_of as square_of,
    )
    from .guiding.learning import (
        GENERATIONS as GENERATIONS,
        GUIDE as GUIDE,
        GUIDE_CHOICES as GUIDE_CHOICES,
        MANY as MANY,
        Learned as Learned,
        LearnedConnections as LearnedConnections,
        LearnedEmission as LearnedEmission,
        learned_emission as learned_emission,
    )
    from .guiding.lights import LightChoice as LightChoice, LocalLights as LocalLights
    from .guiding.openings import Lines as Lines, OpeningWalk as OpeningWalk
    from .guiding.walk import (
        FOUND_UNITS as FOUND_UNITS,
        GuidedPath as GuidedPath,
        GuidedWalk as GuidedWalk,
        TrainingSamples as TrainingSamples,
    )
    from .irradiance import (
        CacheMap as CacheMap,
        IrradianceCache as IrradianceCache,
        irradiance_gradients as irradiance_gradients,
        stratified_hemispheres as stratified_hemispheres,
    )
    from .lamps.points import point_on as point_on
    from .places import Places as Places, first_collisions as first_collisions, first_smooth as first_smooth
    from .rays import (
        Edge as Edge,
        Event as Event,
        RayRecorder as RayRecorder,
        Rays as Rays,
        Recording as Recording,
        WalkRecorder as WalkRecorder,
        joined_to as joined_to,
        recorded as recorded,
    )
    from .scattering import (
        Evaluated as Evaluated,
        Proposal as Proposal,
        Scattered as Scattered,
        cosine_ratio as cosine_ratio,
        evaluate_camera_end as evaluate_camera_end,
        evaluate_light_end as evaluate_light_end,
        exchanged as exchanged,
        is_smooth as is_smooth,
        roulette as roulette,
        scatter_camera as scatter_camera,
        scatter_light as scatter_light,
        scatter_light_uniform as scatter_light_uniform,
        scatter_uniform as scatter_uniform,
        shadow_roulette as shadow_roulette,
    )
    from .schemes.cells import CellEmission as CellEmission, ImportancePilot as ImportancePilot
    from .schemes.numbers import (
        BlindEmission as BlindEmission,
        EmissionScheme as EmissionScheme,
        GivenNumbers as GivenNumbers,
        UniformLights as UniformLights,
    )
    from .schemes.strata import EMISSION as EMISSION, FIRST_BOUNCE as FIRST_BOUNCE, StratifiedSource as StratifiedSource
    from .skyviews import SkyViews as SkyViews
    from .surrounding import Surroundings as Surroundings, surroundings as surroundings
    from .vertex import Vertex as Vertex, WalkVertex as WalkVertex
    from .visibility import Visibility as Visibility, past_lamps as past_lamps
    from .walk import (
        CameraPath as CameraPath,
        Emission as Emission,
        MapEnd as MapEnd,
        SubPath as SubPath,
        Walker as Walker,
        component_fields as component_fields,
        ones as ones,
    )
else:
    __getattr__, __dir__ = on_use(__name__)
