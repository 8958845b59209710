"""What each verb does: a file a verb, or several that begin with its name; each is imported when its verb is called."""
