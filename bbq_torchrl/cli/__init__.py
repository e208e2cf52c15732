"""The console command ``bbq``."""
