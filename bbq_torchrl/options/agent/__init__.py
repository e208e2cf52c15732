"""The options of ``agent=``: what learns."""
