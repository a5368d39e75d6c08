from .page import PairFacts as PairFacts, change_page as change_page, read_pair_facts as read_pair_facts
