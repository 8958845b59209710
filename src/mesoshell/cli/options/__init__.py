"""What each verb takes: a file a verb, dataclasses only, which the parser reads for `--help`."""
