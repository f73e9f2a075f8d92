"""Online reconstruction: keyframes, view sets, lazy fusion, meshing."""
