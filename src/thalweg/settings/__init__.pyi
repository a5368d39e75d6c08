from .campaign import ID_PATTERN as ID_PATTERN, Campaign as Campaign
from .checks_files import photographs_in as photographs_in
from .checks_place import mount_sources as mount_sources, utm_code as utm_code
from .generate import schema_text as schema_text, write_generated as write_generated
from .load import (
    load_campaign as load_campaign,
    load_campaigns as load_campaigns,
    with_calibrations as with_calibrations,
)
from .messages import mistake as mistake, natural_order as natural_order, value_at as value_at
from .template import (
    campaign_text as campaign_text,
    epochs_text as epochs_text,
    position_sources as position_sources,
)
