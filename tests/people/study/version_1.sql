PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE agent (
    name TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL
) STRICT;
INSERT INTO "agent" VALUES('secret-bbqn','weights of secret-bbqn');
INSERT INTO "agent" VALUES('secret-dqn','weights of secret-dqn');
CREATE TABLE exchange (
    session INTEGER NOT NULL REFERENCES session,
    number INTEGER NOT NULL,
    nonce TEXT NOT NULL,
    at REAL NOT NULL,
    text TEXT NOT NULL,
    answer TEXT NOT NULL,
    heard TEXT NOT NULL,
    said TEXT NOT NULL,
    beliefs TEXT,
    state TEXT NOT NULL,
    PRIMARY KEY (session, number),
    UNIQUE (session, nonce)
) STRICT;
INSERT INTO "exchange" VALUES(1,1,'nonce-number-0000000002',1000003.0,'city=philly','Which city? (11 letters)','{"act": "inform", "informs": {"city": "philly"}, "requests": [], "confidence": 0.875}','{"act": "request", "informs": {}, "requests": ["city"], "confidence": null}','{"actions": [{"action": "request(city)", "mean": 1.25, "band50": [1.0, 1.5], "band90": [0.5, 2.0], "p_best": 0.75}, {"action": "thanks", "mean": -3.0, "band50": [-3.5, -2.5], "band90": [-4.0, -2.0], "p_best": 0.25}], "entropy": 0.5625}','{"city": "philly"}');
INSERT INTO "exchange" VALUES(1,2,'nonce-number-0000000003',1000004.0,'bye','Goodbye.','{"act": "request", "informs": {}, "requests": [], "confidence": 0.875}','{"act": "thanks", "informs": {}, "requests": [], "confidence": null}','{"actions": [{"action": "request(city)", "mean": 1.25, "band50": [1.0, 1.5], "band90": [0.5, 2.0], "p_best": 0.75}, {"action": "thanks", "mean": -3.0, "band50": [-3.5, -2.5], "band90": [-4.0, -2.0], "p_best": 0.25}], "entropy": 0.5625}','{"city": "philly"}');
INSERT INTO "exchange" VALUES(3,1,'nonce-number-0000000005',1000006.0,'city=tampa','Which city? (10 letters)','{"act": "inform", "informs": {"city": "tampa"}, "requests": [], "confidence": 0.875}','{"act": "request", "informs": {}, "requests": ["city"], "confidence": null}','{"actions": [{"action": "request(city)", "mean": 1.25, "band50": [1.0, 1.5], "band90": [0.5, 2.0], "p_best": 0.75}, {"action": "thanks", "mean": -3.0, "band50": [-3.5, -2.5], "band90": [-4.0, -2.0], "p_best": 0.25}], "entropy": 0.5625}','{"city": "tampa"}');
CREATE TABLE person (
    id INTEGER PRIMARY KEY,
    token TEXT NOT NULL UNIQUE,
    place INTEGER NOT NULL,
    enrolled REAL NOT NULL,
    active REAL NOT NULL
) STRICT;
INSERT INTO "person" VALUES(1,'4c5a2b3877007633eb0661a3cee84608558c5da6bff3b8a2e808ddf6a78be233',0,1000001.0,1000005.0);
INSERT INTO "person" VALUES(2,'b9a005e3266fc6dd885b132c1c5299e8b7724eee780d4080ce38235e7ed7620c',1,1000002.0,1000006.0);
CREATE TABLE rating (
    session INTEGER PRIMARY KEY REFERENCES session,
    nonce TEXT NOT NULL,
    at REAL NOT NULL,
    overall INTEGER NOT NULL CHECK (overall BETWEEN 1 AND 5),
    naturalness INTEGER NOT NULL CHECK (naturalness BETWEEN 1 AND 5),
    coherence INTEGER NOT NULL CHECK (coherence BETWEEN 1 AND 5),
    completion INTEGER NOT NULL CHECK (completion BETWEEN 1 AND 5),
    verdict INTEGER NOT NULL CHECK (verdict IN (0, 1))
) STRICT;
INSERT INTO "rating" VALUES(1,'nonce-number-0000000004',1000005.0,4,4,4,4,1);
CREATE TABLE session (
    id INTEGER PRIMARY KEY,
    person INTEGER NOT NULL REFERENCES person,
    position INTEGER NOT NULL,
    agent TEXT NOT NULL REFERENCES agent,
    goal INTEGER NOT NULL,
    ended REAL,
    ended_by TEXT CHECK (ended_by IN ('agent', 'person', 'turns')),
    success INTEGER CHECK (success IN (0, 1)),
    reasons TEXT,
    UNIQUE (person, position)
) STRICT;
INSERT INTO "session" VALUES(1,1,1,'secret-bbqn',1,1000004.0,'agent',0,'["no offer", "questions"]');
INSERT INTO "session" VALUES(2,1,2,'secret-dqn',5,NULL,NULL,NULL,NULL);
INSERT INTO "session" VALUES(3,2,1,'secret-dqn',5,NULL,NULL,NULL,NULL);
INSERT INTO "session" VALUES(4,2,2,'secret-bbqn',1,NULL,NULL,NULL,NULL);
CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    terms TEXT NOT NULL,
    package TEXT NOT NULL,
    secret TEXT NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    created REAL NOT NULL
) STRICT;
INSERT INTO "study" VALUES(1,'{"name": "Tickets", "consent": "You agree.", "agents": {"secret-bbqn": "runs/vault-bbqn", "secret-dqn": "runs/vault-dqn"}, "pairs": [["secret-bbqn", "secret-dqn"]], "participants": 5, "domain": "movie", "sessions": 2, "goals": [1, 2, 3, 5], "max_turns": 20, "idle_minutes": 60, "joins_per_minute": 5, "retention": "", "ask_below": {}, "control": {}}','0.2.0.dev0','secret of version 1',0,1000000.0);
CREATE INDEX person_by_place ON person (place);
COMMIT;
