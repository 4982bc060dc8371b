#!/bin/sh
# sh cruise.sh PARAMETERS SCENARIO RESULTS: reads two files of JSON, writes one.
set -eu
LC_ALL=C exec awk '
    { text = text "," $0 } # flat JSON: `"name": value` between commas
    END {
        gsub(/[{}" \t]/, "", text)
        for (n = split(text, pairs, ","); n > 0; n--) { split(pairs[n], pair, ":"); given[pair[1]] = pair[2] }
        dt = 0.1; mass = 1600; pi = 3.14159265358979; v = given["start"]; limit = given["limit"]
        strongest = given["gearing"] == "long" ? 1.6 : 2.4
        for (k = 0; k < 400; k++) {
            slope = given["hill"] / 100 * sin(pi * x / given["length"])
            ahead = given["hill"] / 100 * sin(pi * (x + 10 * given["preview"]) / given["length"])
            error = limit - v
            wanted = given["kp"] * error + given["ki"] * sum + 9.81 * ahead
            drive = wanted > strongest ? strongest : wanted < -4 ? -4 : wanted
            if (drive == wanted) sum += error * dt
            wind = v + given["headwind"]
            a = drive - 9.81 * slope - (0.4 * wind * wind + 150) / mass
            if (k) { jerks += (a - before) * (a - before) / dt; errors += error * error * dt }
            before = a
            if (drive > 0) energy += mass * drive * (given["gearing"] == "long" ? 1 : 1.06) * v * dt / 3.6e6
            x += v * dt; v += a * dt
            if (v - limit > over) over = v - limit
        }
        if (over > 2) print "{\"failure\": \"too_fast\", \"measures\": {}}"
        else printf "{\"measures\": {\"rms_error\": %.17g, \"energy_kwh\": %.17g, \"worst_over\": %.17g, \"rms_jerk\": %.17g}}\n", \
            sqrt(errors / 40), energy, over, sqrt(jerks / 40)
    }' "$1" "$2" > "$3"
