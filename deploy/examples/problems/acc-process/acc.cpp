// Adaptive cruise control by the intelligent driver model (Treiber, Hennecke, Helbing 2000): answers a line of JSON with a line of JSON.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

// Returns the number after "name": behind `start`; enough for lines of drivecal, which hold no line breaks.
static double number(const std::string& line, const std::string& name, size_t start) {
    const size_t at = line.find("\"" + name + "\":", start);
    if (at == std::string::npos) throw std::runtime_error("no " + name);
    return std::strtod(line.c_str() + at + name.size() + 3, nullptr);
}

static std::string simulate(const std::string& line) {
    const size_t data = line.find("\"data\":"), parameters = line.find("\"parameters\":");
    const double gap0 = number(line, "gap", data), fast = number(line, "speed", data), slow = number(line, "slow", data);
    const double period = number(line, "period", data), duration = number(line, "duration", data);
    const double v0 = number(line, "v0", parameters), T = number(line, "T", parameters), s0 = number(line, "s0", parameters);
    const double b = number(line, "b", parameters);
    const bool eco = line.find("\"eco\"", parameters) != std::string::npos, sport = line.find("\"sport\"", parameters) != std::string::npos;
    const double a = number(line, "a", parameters) * (eco ? 0.8 : sport ? 1.2 : 1.0);
    const double dt = 0.005, mass = 1600, pi = 3.14159265358979323846;
    const int steps = int(duration / dt), late = int(number(line, "delay", parameters) * 0.1 / dt);
    std::vector<double> commands(steps + late + 1, 0.0);
    double v = fast, gap = gap0, energy = 0, ttc = 100, gaps = 0, jerks = 0, distance = 0, before = 0;
    for (int k = 0; k < steps; ++k) {
        const double t = k * dt, lead = slow + (fast - slow) * 0.5 * (1 + std::cos(2 * pi * t / period));
        const double wanted = s0 + std::max(0.0, v * T + v * (v - lead) / (2 * std::sqrt(a * b)));
        const double speed = v / v0, room = wanted / std::max(gap, 0.1);
        commands[k + late] = std::clamp(a * (1 - speed * speed * speed * speed - room * room), -3.5, 3.0);
        const double acceleration = commands[k];
        const double force = mass * acceleration + 0.4 * v * v + 150;  // air and rolling resistance
        energy += std::max(0.0, force) * v * dt / 3.6e6;
        jerks += (acceleration - before) * (acceleration - before) / dt;
        before = acceleration;
        distance += v * dt;
        gap += (lead - v) * dt;
        v = std::max(0.0, v + acceleration * dt);
        if (v > lead + 0.01) ttc = std::min(ttc, gap / (v - lead));
        gaps += gap * dt;
        if (gap <= 0) return "\"failure\": \"collision\", \"measures\": {}";
    }
    char text[400];
    std::snprintf(text, sizeof text, "\"measures\": {\"energy_kwh\": %.17g, \"min_ttc_s\": %.17g, \"mean_gap_m\": %.17g, \"rms_jerk\": %.17g, \"distance_m\": %.17g}",
                  energy, ttc, gaps / duration, std::sqrt(jerks / duration), distance);
    return text;
}

int main() {
    std::string line;
    while (std::getline(std::cin, line)) {
        if (line.find("\"quit\":") != std::string::npos) return 0;
        if (line.find("\"drivecal\":") != std::string::npos) {
            std::cout << "{\"ready\": true}" << std::endl;
            continue;
        }
        const std::string id = std::to_string((long long)number(line, "id", 0));
        try {
            std::cout << "{\"id\": " << id << ", " << simulate(line) << "}" << std::endl;  // endl flushes: drivecal waits for the line
        } catch (const std::exception& error) {
            std::cout << "{\"id\": " << id << ", \"error\": \"" << error.what() << "\"}" << std::endl;
        }
    }
}
