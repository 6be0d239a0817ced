"""What the model lacks, before and after: python docs/examples/diagnose_my_log.py LOG [VEHICLE.json [TYRE.json]]"""

import json
import subprocess
import sys

log, *declared = sys.argv[1:]
options = [word for pair in zip(("--vehicle", "--tyre"), declared, strict=False) for word in pair]
command = [sys.executable, "-m", "hil_gateway", "diagnose", log, *options, "--json"]
result = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)

print(f"verdict: {result['verdict']}")
for effect in result["effects"]:
    sizes = (f"{name} = {p['value']:.4g} +- {p['std']:.2g} {p['unit']}" for name, p in effect["parameters"].items())
    print(f"{effect['name']}: {', '.join(sizes)}, confidence {effect['confidence']:.2f}")
for left in result["unexplained"]:
    print(f"left: {left['description']}")
for channel, rmse in result["channels"].items():
    before, after, noise = (rmse[key] for key in ("declared", "with_effects", "noise_floor"))
    print(f"{channel:8} error {before:.3f} before, {after:.3f} after, noise {noise:.3f}")
