"""Runs a whole job over gRPC, knowing nothing but the address: everything else comes from reflection."""
import io
import json
import sys
import tarfile
import zipfile

import grpc
from google.protobuf import descriptor_pool, message_factory
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

address, problem = sys.argv[1], open(sys.argv[2]).read()
channel = grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", -1)])
database = ProtoReflectionDescriptorDatabase(channel)
assert "quadrille.v1.Planning" in database.get_services(), database.get_services()
pool = descriptor_pool.DescriptorPool(database)
service = pool.FindServiceByName("quadrille.v1.Planning")


def call(name, /, **fields):
    method = service.FindMethodByName(name)
    made = lambda descriptor: message_factory.GetMessageClass(descriptor)
    open_call = channel.unary_stream if method.server_streaming else channel.unary_unary
    return open_call(
        f"/{service.full_name}/{name}",
        request_serializer=lambda message: message.SerializeToString(),
        response_deserializer=made(method.output_type).FromString,
    )(made(method.input_type)(**fields), timeout=60)


def refused(code, name, /, **fields):
    try:
        call(name, **fields)
    except grpc.RpcError as error:
        assert error.code() == code, error
        metadata = {key: value for key, value in error.trailing_metadata()}
        document = json.loads(metadata["quadrille-problem-bin"])
        assert metadata["quadrille-code"] == document["code"]
        return document
    raise AssertionError(f"{name} was not refused")


version = call("GetVersion")
assert (version.name, version.api, version.plan_schema) == ("quadrille", "v1", "quadrille.plan/1")
assert json.loads(call("GetLimits").limits_json)["arms"] > 0
assert "switch/2x2" in call("ListScenarios").names
assert call("Validate", problem_json=problem).arms == 2

workcell = json.dumps(json.loads(problem)["workcell"])
registered = call("PutWorkcell", id="cell", workcell_json=workcell)
referring = json.dumps({**json.loads(problem), "workcell": registered.digest})
assert [one.id for one in call("ListWorkcells").workcells] == ["cell"]
packed = io.BytesIO()
with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
    archive.writestr("cell/workcell.json", workcell)
    archive.writestr("cell/notes/read me.txt", "of no use")
assert call("PutWorkcell", id="zipped", zip=packed.getvalue()).digest == registered.digest
packed = io.BytesIO()
with tarfile.open(fileobj=packed, mode="w:gz") as archive:
    entry = tarfile.TarInfo("./workcell.json")
    entry.size = len(workcell.encode())
    archive.addfile(entry, io.BytesIO(workcell.encode()))
assert call("PutWorkcell", id="tarred", tar_gz=packed.getvalue()).digest == registered.digest
assert refused(grpc.StatusCode.INVALID_ARGUMENT, "PutWorkcell", id="bad", zip=b"PK")["code"] == "bad_bundle"
assert [call("DeleteWorkcell", id=one) is not None for one in ("zipped", "tarred")]
assert refused(grpc.StatusCode.NOT_FOUND, "DeleteWorkcell", id="zipped")["code"] == "not_found"
assert json.loads(call("GetWorkcell", id="cell").workcell_json) == json.loads(workcell)

options = {"idempotency_key": "k", "labels": {"line": "7"}, "priority": 3, "queue_ttl_s": 60.0}
job = call("CreateJob", problem_json=referring, options=options)
assert job.id == call("CreateJob", problem_json=referring, options=options).id
assert refused(grpc.StatusCode.ALREADY_EXISTS, "CreateJob", problem_json=problem, options=options)["code"] == "idempotency_mismatch"

events = list(call("WatchJob", job_id=job.id))
durable = [event for event in events if event.WhichOneof("body") != "progress"]
assert [event.seq for event in durable] == list(range(1, len(durable) + 1))
assert [event.WhichOneof("body") for event in durable] == ["queued", "started"] + ["incumbent"] * 3 + ["terminal"]
assert [event.seq for event in call("WatchJob", job_id=job.id, after=4)] == [5, 6]
assert not list(call("WatchJob", job_id=job.id, after=6))
found = call("GetJob", job_id=job.id)
assert found.labels["line"] == "7" and found.priority == 3 and found.best.steps == 6
assert [one.revision for one in call("ListIncumbents", job_id=job.id, **{"from": 2}).incumbents] == [2, 3]
best = call("GetSolution", job_id=job.id)
assert best.revision == 3
assert not call("Verify", problem_json=problem, plan_json=best.plan_json).valid, "a plan in which nothing moves"
assert [one.id for one in call("ListJobs", labels=["line:7"]).jobs] == [job.id]
modes = json.loads(call("GetModes", workcell_id="cell").mode_graph_json)
assert modes["schema"] == "quadrille.mode_graph/1"
assert json.loads(call("GetScenario", name="switch/2x2").problem_json)["schema"] == "quadrille.problem/1"
again = call("CreateJob", problem_json=problem.replace(json.loads(problem)["name"], "wait"))
assert refused(grpc.StatusCode.FAILED_PRECONDITION, "DeleteJob", job_id=again.id)["code"] == "job_not_ended"
call("CancelJob", job_id=again.id)
streamed = list(call("Plan", problem_json=problem))
assert streamed[-1].WhichOneof("body") == "terminal" and streamed[-1].terminal.state == found.state
call("DeleteJob", job_id=job.id)
assert refused(grpc.StatusCode.NOT_FOUND, "GetJob", job_id=job.id)["code"] == "not_found"
assert refused(grpc.StatusCode.INVALID_ARGUMENT, "CreateJob", problem_json="{")["code"] == "invalid_json"
call("DeleteWorkcell", id="cell")
assert refused(grpc.StatusCode.INVALID_ARGUMENT, "Validate", problem_json=json.dumps({**json.loads(problem), "workcell": "cell"}))
print("done")
