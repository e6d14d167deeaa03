"""POSTs a problem, shows each plan as it comes, and saves the best: plan.py http://127.0.0.1:8080 problem.json plan.json"""
import json, sys, urllib.request

service, problem, saved = sys.argv[1:]
request = urllib.request.Request(service + "/v1/plan", open(problem, "rb").read(), {"Content-Type": "application/json"})
with urllib.request.urlopen(request) as events:
    for event in map(json.loads, events):
        if event["type"] == "incumbent":
            print(f"plan {event['revision']}: {event['metrics']['duration_s']:.3f} s, {event['metrics']['steps']} steps")
            link = service + f"/v1/jobs/{event['job_id']}/solutions/best"
print(event["state"], event["termination_reason"])
if event["metrics"] is None:
    sys.exit(event.get("diagnosis"))
urllib.request.urlretrieve(link, saved)
