"""Why a run is not honest: the filter runs again without each thing that may be to blame."""
