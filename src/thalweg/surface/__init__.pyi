from .area import Area as Area
from .by_data import (
    Texture as Texture,
    meshing_by_data as meshing_by_data,
    texture_of as texture_of,
    usual_side_m as usual_side_m,
)
from .cloud_to_mesh import Distances as Distances, Surface as Surface
from .meshing import BankFrame as BankFrame, read_triangles as read_triangles
from .reference import (
    area_margin_m as area_margin_m,
    compare_files as compare_files,
    mesh_reference as mesh_reference,
    read_reference as read_reference,
)
from .rigid_fit import (
    AXES as AXES,
    LEAST_VISIBLE as LEAST_VISIBLE,
    TUKEY as TUKEY,
    Motion as Motion,
    jackknife as jackknife,
    motions_in_words as motions_in_words,
    tukey as tukey,
    tukey_slope as tukey_slope,
    visible_motions as visible_motions,
)
from .thinning import LowerEnvelope as LowerEnvelope, heights_above_envelope as heights_above_envelope
