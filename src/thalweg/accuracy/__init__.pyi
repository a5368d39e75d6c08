from .comparison import (
    CLOUD_TO_MESH as CLOUD_TO_MESH,
    ComparisonSettings as ComparisonSettings,
    after_motion as after_motion,
    check_frames as check_frames,
    compare_with_mesh as compare_with_mesh,
    normalised_distances as normalised_distances,
    predicted_sigma_m as predicted_sigma_m,
)
from .comparison_tables import (
    ALL as ALL,
    AS_MEASURED as AS_MEASURED,
    REGISTERED as REGISTERED,
    WITHOUT_OUTLIERS as WITHOUT_OUTLIERS,
    by_range_table as by_range_table,
    classes_in_words as classes_in_words,
    independent_squares as independent_squares,
    point_sets as point_sets,
)
from .reference_comparison import compare_with_reference as compare_with_reference
from .registration import (
    PlacedCloud as PlacedCloud,
    hotelling as hotelling,
    register as register,
    register_places as register_places,
)
from .solutions import (
    CERTAIN as CERTAIN,
    CHAINS as CHAINS,
    COMMON as COMMON,
    LEAST as LEAST,
    PUBLISHED_CROSSING_M as PUBLISHED_CROSSING_M,
    REFERENCE as REFERENCE,
    SHOTS as SHOTS,
    TRAJECTORY as TRAJECTORY,
    WITHOUT as WITHOUT,
    Chain as Chain,
    chains_by_range as chains_by_range,
    chains_of as chains_of,
    chains_table as chains_table,
    check_chains as check_chains,
    crossing_of as crossing_of,
    crossings_m as crossings_m,
    length_s as length_s,
    longest_gap_s as longest_gap_s,
    outage_table as outage_table,
    range_facts as range_facts,
    shared as shared,
    valid_spans as valid_spans,
    value as value,
    within as within,
)
from .statistics import (
    VERDICTS as VERDICTS,
    by_range_class as by_range_class,
    chi_square_band as chi_square_band,
    consistency_in_words as consistency_in_words,
    describe_errors as describe_errors,
    outlier_limits as outlier_limits,
    range_class as range_class,
    verdict_of as verdict_of,
    verdict_of_ratio as verdict_of_ratio,
)
from .summary import (
    number_text as number_text,
    summary_lines as summary_lines,
    summary_table as summary_table,
)
