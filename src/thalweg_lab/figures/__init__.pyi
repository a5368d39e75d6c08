from .joint_river import joint_river_figure as joint_river_figure
from .ledger_table import ledger_section as ledger_section, write_ledger as write_ledger
