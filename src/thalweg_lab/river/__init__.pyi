from .mesh import (
    BARE_GROUND as BARE_GROUND,
    BOX_FACES as BOX_FACES,
    COLOUR as COLOUR,
    HULL_MATERIAL as HULL_MATERIAL,
    HULL_REFLECTANCE as HULL_REFLECTANCE,
    LENGTH_M as LENGTH_M,
    REFLECTANCE as REFLECTANCE,
    REFLECTANCE_1550 as REFLECTANCE_1550,
    VEGETATION as VEGETATION,
    WIDTH_M as WIDTH_M,
    Hull as Hull,
    Material as Material,
    MeshParts as MeshParts,
    boxes as boxes,
    hull_mesh as hull_mesh,
    tube_faces as tube_faces,
    tubes as tubes,
)
from .scene import (
    Scene as Scene,
    build_scene as build_scene,
    outlook as outlook,
    simulate_scene as simulate_scene,
)
from .shading import (
    MURK as MURK,
    corner_shares as corner_shares,
    fresnel as fresnel,
    half_sphere as half_sphere,
    hash01 as hash01,
    metered as metered,
    mirrored as mirrored,
    vertex_normals as vertex_normals,
)
from .waves import Waves as Waves
