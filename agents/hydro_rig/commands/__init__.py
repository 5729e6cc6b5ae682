"""The commands of ``hydro`` that need a machine or its recordings."""
