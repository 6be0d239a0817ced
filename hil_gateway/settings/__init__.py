"""Parts of the configuration that are declared apart from it, for it and for those they configure."""
