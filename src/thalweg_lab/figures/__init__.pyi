from .ledger_table import ledger_section as ledger_section, write_ledger as write_ledger
