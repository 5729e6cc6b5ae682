"""The servo axis as hydraulics: parameters, equations, integration, analysis. Knows nothing of learning."""
