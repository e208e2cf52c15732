"""The options of ``explore=``: how an agent acts while it learns."""
