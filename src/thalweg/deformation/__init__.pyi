from .compare import Comparison as Comparison
from .foreign import compare_clouds as compare_clouds, write_changes as write_changes
