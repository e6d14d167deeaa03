"""Distances and poses of cell.json by Pinocchio and coal, for 1,000 states.

    pip install pin
    python tests/foreign/make_reference.py > tests/foreign/reference.csv

Columns: the joints of arm "one" (7), of arm "two" (7), position (3) and quaternion xyzw (4) of the
tool of "one" in the world, and three signed distances: one against two, one against the box, and one's
links against its own links that are three or more movable joints apart; between the arms only what
lies beyond the third joint of either. Negative means
overlap; how deep is not comparable, since coal takes each capsule as a cylinder and two balls.
"""

import json
import pathlib
import random

import coal
import numpy as np
import pinocchio as pin

here = pathlib.Path(__file__).parent
cell = json.loads((here / "cell.json").read_text())["workcell"]
urdf = here / "../../scenarios/robots/iiwa14.urdf"


def placement(pose):
    p = pose.get("position", {"x": 0, "y": 0, "z": 0})
    o = pose.get("orientation", {"x": 0, "y": 0, "z": 0, "w": 1})
    return pin.SE3(pin.Quaternion(o["w"], o["x"], o["y"], o["z"]).matrix(), np.array([p["x"], p["y"], p["z"]]))


def shape(s):
    if s["type"] == "box":
        return coal.Box(s["size"]["x"], s["size"]["y"], s["size"]["z"])
    return coal.Cylinder(s["radius"], s["length"])


model = pin.buildModelFromUrdf(str(urdf))
data = model.createData()
geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION)
flange = model.getFrameId("flange")


def bodies(arm, q):
    """(rank, geometry, pose in the world); the rank counts movable joints from the root."""
    base = placement(arm["base"])
    pin.forwardKinematics(model, data, q)
    pin.updateFramePlacements(model, data)
    out = []
    for g in geometry.geometryObjects:
        out.append((g.parentJoint, g.geometry, base * data.oMi[g.parentJoint] * g.placement))
    for c in arm["tool"]["collision"]:
        out.append((7, shape(c["shape"]), base * data.oMf[flange] * placement(c["pose"])))
    return out, base * data.oMf[flange] * placement({"position": arm["tool"]["tcp"]["position"]})


request = coal.DistanceRequest()
request.enable_signed_distance = True


def distance(a, b):
    result = coal.DistanceResult()
    t1 = coal.Transform3s(a[2].rotation, a[2].translation)
    t2 = coal.Transform3s(b[2].rotation, b[2].translation)
    return coal.distance(a[1], t1, b[1], t2, request, result)


random.seed(14)
one, two = cell["arms"]
box = (0, shape(cell["obstacles"][0]["shape"]), placement(cell["obstacles"][0]["pose"]))
for _ in range(1000):
    q = [[round(random.uniform(lo, hi), 4) for lo, hi in zip(model.lowerPositionLimit, model.upperPositionLimit)] for _ in range(2)]
    first, tool = bodies(one, np.array(q[0]))
    second, _ = bodies(two, np.array(q[1]))
    between = min(distance(a, b) for a in first for b in second if min(a[0], b[0]) >= 3)
    boxed = min(distance(a, box) for a in first)
    itself = min(distance(a, b) for a in first for b in first if b[0] - a[0] >= 3)
    turn = pin.Quaternion(tool.rotation)
    values = list(tool.translation) + [turn.x, turn.y, turn.z, turn.w, between, boxed, itself]
    print(",".join([f"{v:.4f}".rstrip("0") for v in q[0] + q[1]] + [f"{v:.6f}" for v in values]))
