"""Receding horizon for crowds: windows towards soft goals, of which the first part is kept, and an exact end."""
