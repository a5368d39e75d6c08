from .clouds import (
    SOURCE_WORDS as SOURCE_WORDS,
    Cloud as Cloud,
    Fit as Fit,
    Source as Source,
    fit_cloud as fit_cloud,
    join_clouds as join_clouds,
    joined_parts as joined_parts,
    read_cloud as read_cloud,
    read_fit as read_fit,
)
from .dtm import (
    BANDS as BANDS,
    Dtm as Dtm,
    build_dtm as build_dtm,
    dtm_facts as dtm_facts,
    seam_steps as seam_steps,
)
from .ground import Ground as Ground, filter_ground as filter_ground, ground_in_words as ground_in_words
from .river import Flow as Flow, River as River, read_river as read_river
