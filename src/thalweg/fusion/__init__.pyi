from .clouds import (
    SOURCE_WORDS as SOURCE_WORDS,
    Cloud as Cloud,
    Fit as Fit,
    Source as Source,
    cloud_of_bed as cloud_of_bed,
    fit_cloud as fit_cloud,
    join_clouds as join_clouds,
    joined_parts as joined_parts,
    read_cloud as read_cloud,
    read_ground as read_ground,
)
from .dtm import (
    BANDS as BANDS,
    Dtm as Dtm,
    build_dtm as build_dtm,
    dtm_facts as dtm_facts,
    seam_steps as seam_steps,
    separation_at as separation_at,
)
from .exports import (
    RiverMesh as RiverMesh,
    contour_lines as contour_lines,
    export_river as export_river,
    mesh_river as mesh_river,
    water_of as water_of,
    write_2dm as write_2dm,
    write_bag as write_bag,
    write_csv as write_csv,
    write_hecras as write_hecras,
    write_selafin as write_selafin,
    write_swmm as write_swmm,
    write_ugrid as write_ugrid,
)
from .ground import Ground as Ground, filter_ground as filter_ground
from .maps import map_of_bed as map_of_bed, map_of_campaign as map_of_campaign, write_layers as write_layers
from .measures import (
    WIDE as WIDE,
    Section as Section,
    cut_sections as cut_sections,
    depths_along as depths_along,
    hydraulic_table as hydraulic_table,
    hypsometry as hypsometry,
    long_profile as long_profile,
    volume_below as volume_below,
)
from .river import Flow as Flow, River as River, read_river as read_river
