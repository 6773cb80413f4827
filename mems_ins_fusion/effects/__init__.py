"""What real vehicles and sensors do and the filter's model may lack: one module each, and the registry."""
from .. import parameters  # noqa: F401  the table of parameters takes in those of the effects: it must come first
