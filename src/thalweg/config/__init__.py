"""Campaign files: models, checks and messages. Every mistake is reported at once, with its cure."""
