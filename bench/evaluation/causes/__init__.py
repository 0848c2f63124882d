"""Why a run is not consistent: the filter runs again without each thing that may be to blame."""
