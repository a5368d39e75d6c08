from .adjustment import calibrate_lines as calibrate_lines
from .comparison import compare_models as compare_models, nested_tests as nested_tests
from .labels import (
    Detections as Detections,
    Hypotheses as Hypotheses,
    MapSettings as MapSettings,
    Pose as Pose,
    hypotheses as hypotheses,
)
from .level_points import LevelPoints as LevelPoints
from .models import (
    KINDS as KINDS,
    Kind as Kind,
    Lines as Lines,
    NominalDiode as NominalDiode,
    line_model as line_model,
)
from .scan_labels import (
    Flag as Flag,
    ScanLabels as ScanLabels,
    label_scan as label_scan,
    label_single_image as label_single_image,
    line_table as line_table,
)
