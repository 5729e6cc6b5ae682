"""Windows of axes with a fault and a leak, as a detector reads them."""

from hydro_agents.detection.detector import Windows
from hydro_agents.evaluation.leak_protocol import LeakProtocol, simulated_windows

FAULTS = {
    "none": {},
    "valve": {"valve_null_shift": -0.01},
    "valve edges": {"valve_underlap": 0.025},
    "sensor": {"pressure_a_offset": 0.03},
    "rod seal": {"external_leak": 2.0},
    "return line": {"tank_pressure": 1e6},
}


def made(fault, leak, samples=200):
    """Two windows of the same two plants with a fault and a leak in l/min."""
    conditions = {"c": {"duration": samples * 0.005, "faults": FAULTS[fault]}}
    protocol = LeakProtocol(detectors={"D": {"kind": "head"}}, base="c", conditions=conditions)
    signals, _ = simulated_windows(protocol.tasks["c"], "PID", protocol.cases_in("c", leak, 2), samples)
    return Windows.of(signals)
