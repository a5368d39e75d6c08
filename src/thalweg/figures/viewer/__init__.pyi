from .page import (
    MOST_POINTS as MOST_POINTS,
    View as View,
    read_view as read_view,
    read_views as read_views,
    write_survey_viewer as write_survey_viewer,
    write_viewer as write_viewer,
)
