from .budget_page import (
    group_shares as group_shares,
    page as page,
    what_the_cells_tell as what_the_cells_tell,
)
from .files import (
    CLASSES as CLASSES,
    read_ledger as read_ledger,
    read_ledgers as read_ledgers,
    result_files as result_files,
)
from .ledger import (
    MEANINGS as MEANINGS,
    NO_RESULT as NO_RESULT,
    NOT_MATCHED as NOT_MATCHED,
    VERDICTS as VERDICTS,
    VERDICTS_NOTE as VERDICTS_NOTE,
    Results as Results,
    by_class as by_class,
    counts as counts,
    distinct as distinct,
    judged as judged,
    markdown as markdown,
    missing_words as missing_words,
    readable as readable,
    sentence as sentence,
)
from .paper_models import SMALL_RIVER_WIDTH_M as SMALL_RIVER_WIDTH_M
from .published_budgets import read_published as read_published
from .verdicts import (
    ITEMS as ITEMS,
    headlines as headlines,
    missing_items as missing_items,
    parts_of as parts_of,
    read_pages as read_pages,
    recorded as recorded,
    told as told,
    whole_ledger as whole_ledger,
)
