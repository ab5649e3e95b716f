"""Light transport for all methods: vertices, walks, emission, camera, scattering, MIS weights, vertex stores."""

from . import dimensions
from .bidirectional.cache import PICK_BLOCK, LightCache
from .bidirectional.camera_walk import CameraWalk
from .bidirectional.light_walk import LightPath, LightWalk
from .bidirectional.linear import Counts
from .bidirectional.mis import GRAZING, Mis
from .bidirectional.moments import TILE, Candidate, Moments
from .bidirectional.photons import Gather, Photon, Photons, unfolded
from .bidirectional.pyramid import PYRAMID_MAX, Pyramid
from .bidirectional.single import SingleContribution, SingleTechnique
from .bidirectional.sinks import CameraSink, Contribution, Sink, SplatSink
from .bidirectional.techniques import Techniques
from .bidirectional.vertices import Kind, LightVertex, LightVertices, needs_interaction
from .camera import CameraConnection, CameraSampler, SplatPlace, Splats
from .direct import DirectWeights
from .emission import DirectSample, EmittedRay, emission_of_hit, emit, is_emissive, sample_direct
from .endings.ambient import AMBIENT_WALKS, AmbientScene, AmbientTable, ambient_scene
from .endings.maps import EndingGuidedWalk, EndingInIndirect, EndingWalker, light_of_map
from .firsthits import FirstHits, seen_shapes
from .functions import TransportFunctions, film_picture
from .guiding.connections import CLASSES, ConnectionGuide, ConnectionSums
from .guiding.emission import EmissionGuide, EmissionSums, EmissionTraining
from .guiding.guide import FITS, NOWHERE, Guide, GuidedScattered, direction_of, square_of
from .guiding.learning import (
    GENERATIONS,
    GUIDE,
    GUIDE_CHOICES,
    MANY,
    Learned,
    LearnedConnections,
    LearnedEmission,
    learned_emission,
)
from .guiding.lights import MOST_LIGHTS, LightChoice, LocalLights
from .guiding.walk import FOUND_UNITS, GuidedPath, GuidedWalk, TrainingSamples
from .irradiance import CacheMap, IrradianceCache, irradiance_gradients, stratified_hemispheres
from .lamps.points import point_on
from .places import Places, first_smooth
from .rays import Edge, Event, RayRecorder, Rays, Recording, WalkRecorder, joined_to, recorded
from .scattering import (
    Evaluated,
    Proposal,
    Scattered,
    cosine_ratio,
    evaluate_camera_end,
    evaluate_light_end,
    exchanged,
    geometric_cos,
    is_smooth,
    roulette,
    scatter_camera,
    scatter_light,
    scatter_light_uniform,
    scatter_uniform,
    shadow_roulette,
)
from .schemes.cells import CellEmission, ImportancePilot
from .schemes.numbers import BlindEmission, GivenNumbers, UniformLights
from .schemes.numbers import Emission as EmissionScheme
from .schemes.strata import EMISSION, FIRST_BOUNCE, StratifiedSource
from .vertex import Joined, Vertex, WalkVertex
from .visibility import Visibility
from .walk import CameraPath, Emission, MapEnd, SubPath, Walker, component_fields, ones

__all__ = [
    "AMBIENT_WALKS",
    "CLASSES",
    "EMISSION",
    "FIRST_BOUNCE",
    "FITS",
    "FOUND_UNITS",
    "GENERATIONS",
    "GRAZING",
    "GUIDE",
    "GUIDE_CHOICES",
    "MANY",
    "MOST_LIGHTS",
    "NOWHERE",
    "PICK_BLOCK",
    "PYRAMID_MAX",
    "TILE",
    "AmbientScene",
    "AmbientTable",
    "BlindEmission",
    "CacheMap",
    "CameraConnection",
    "CameraPath",
    "CameraSampler",
    "CameraSink",
    "CameraWalk",
    "Candidate",
    "CellEmission",
    "ConnectionGuide",
    "ConnectionSums",
    "Contribution",
    "Counts",
    "DirectSample",
    "DirectWeights",
    "Edge",
    "Emission",
    "EmissionGuide",
    "EmissionScheme",
    "EmissionSums",
    "EmissionTraining",
    "EmittedRay",
    "EndingGuidedWalk",
    "EndingInIndirect",
    "EndingWalker",
    "Evaluated",
    "Event",
    "FirstHits",
    "Gather",
    "GivenNumbers",
    "Guide",
    "GuidedPath",
    "GuidedScattered",
    "GuidedWalk",
    "ImportancePilot",
    "IrradianceCache",
    "Joined",
    "Kind",
    "Learned",
    "LearnedConnections",
    "LearnedEmission",
    "LightCache",
    "LightChoice",
    "LightPath",
    "LightVertex",
    "LightVertices",
    "LightWalk",
    "LocalLights",
    "MapEnd",
    "Mis",
    "Moments",
    "Photon",
    "Photons",
    "Places",
    "Proposal",
    "Pyramid",
    "RayRecorder",
    "Rays",
    "Recording",
    "Scattered",
    "SingleContribution",
    "SingleTechnique",
    "Sink",
    "SplatPlace",
    "SplatSink",
    "Splats",
    "StratifiedSource",
    "SubPath",
    "Techniques",
    "TrainingSamples",
    "TransportFunctions",
    "UniformLights",
    "Vertex",
    "Visibility",
    "WalkRecorder",
    "WalkVertex",
    "Walker",
    "ambient_scene",
    "component_fields",
    "cosine_ratio",
    "dimensions",
    "direction_of",
    "emission_of_hit",
    "emit",
    "evaluate_camera_end",
    "evaluate_light_end",
    "exchanged",
    "film_picture",
    "first_smooth",
    "geometric_cos",
    "irradiance_gradients",
    "is_emissive",
    "is_smooth",
    "joined_to",
    "learned_emission",
    "light_of_map",
    "needs_interaction",
    "ones",
    "point_on",
    "recorded",
    "roulette",
    "sample_direct",
    "scatter_camera",
    "scatter_light",
    "scatter_light_uniform",
    "scatter_uniform",
    "seen_shapes",
    "shadow_roulette",
    "square_of",
    "stratified_hemispheres",
    "unfolded",
]
