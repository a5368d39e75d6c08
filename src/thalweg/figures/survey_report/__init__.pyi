from .report import write_survey_report as write_survey_report
