"""Everything that touches a machine: recordings, identification, diagnosis, monitoring, and code for a PLC."""
