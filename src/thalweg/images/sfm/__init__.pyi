from .colmap import colmap as colmap, focal_from_exif as focal_from_exif, from_colmap as from_colmap
from .features import (
    WIDEST_DEG as WIDEST_DEG,
    extract_features as extract_features,
    part_of as part_of,
    to_the_rim as to_the_rim,
)
from .mapping import (
    block_facts as block_facts,
    image_table as image_table,
    main_block as main_block,
    map_images as map_images,
)
from .matching import (
    ComparedPairs as ComparedPairs,
    Known as Known,
    Matches as Matches,
    MatchInputs as MatchInputs,
    compare_pairs as compare_pairs,
    joined_parts as joined_parts,
    match_images as match_images,
    part_of_pairs as part_of_pairs,
    plan_of as plan_of,
    read_times as read_times,
)
