"""Everything that touches a machine: recordings, identification, diagnosis, watching, and code for a PLC."""
