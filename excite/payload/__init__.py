"""Payload identification: the body that is attached to a link, from recordings with and without."""
