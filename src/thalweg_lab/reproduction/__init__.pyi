from .files import (
    CLASSES as CLASSES,
    read_ledger as read_ledger,
    read_ledgers as read_ledgers,
    result_files as result_files,
)
from .ledger import (
    MISSED as MISSED,
    NO_RESULT as NO_RESULT,
    VERDICTS_NOTE as VERDICTS_NOTE,
    Results as Results,
    counts as counts,
    judged as judged,
    markdown as markdown,
    readable as readable,
    sentence as sentence,
)
from .verdicts import (
    ITEMS as ITEMS,
    NOT_MATCHED as NOT_MATCHED,
    SIX as SIX,
    found_words as found_words,
    ledger_counts as ledger_counts,
    missing_items as missing_items,
    parts_of as parts_of,
    read_pages as read_pages,
    recorded as recorded,
    whole_ledger as whole_ledger,
)
