from .files import read_ledger as read_ledger, result_files as result_files
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
