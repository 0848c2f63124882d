/* A client of a flight that `bench serve` flies, in one file of C99 on POSIX sockets.
 *
 *     cc -O2 -o flight_client flight_client.c -lm
 *     ./flight_client 5700              gives an estimate
 *     ./flight_client 5700 commands     steers, too: a gentle turn at the height of the start
 *
 * The messages are those of `bench guide serve`. The filter is a strapdown that fixes pull by constant gains:
 * an example of a client, not of a filter. It needs a start that is told. License: Apache-2.0. */

#define _POSIX_C_SOURCE 200112L
#include <arpa/inet.h>
#include <math.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { IMU = 1, FIX = 8, HELLO = 16, START, TURN, ESTIMATE, ATTITUDE, SURFACES, DONE, END };

#define VERSION 1.0
#define MOST 255

/* --- messages */

typedef struct {
    int kind, size;
    unsigned char payload[MOST];
    double value[MOST / 8];
    int valid;
} Message;

static int line;
static uint32_t number;

static void stop(const char *why) {
    fprintf(stderr, "flight_client: %s\n", why);
    exit(1);
}

static uint16_t crc16(uint16_t crc, const unsigned char *data, int size) {
    for (int k = 0; k < size; k++) {
        crc ^= (uint16_t)(data[k] << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* Numbers are little-endian in messages, whatever this machine is. */
static void put(unsigned char *to, uint64_t bits, int size) {
    for (int k = 0; k < size; k++)
        to[k] = (unsigned char)(bits >> 8 * k);
}

static uint64_t get(const unsigned char *from, int size) {
    uint64_t bits = 0;
    for (int k = 0; k < size; k++)
        bits |= (uint64_t)from[k] << 8 * k;
    return bits;
}

static void put_double(unsigned char *to, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    put(to, bits, 8);
}

static double get_double(const unsigned char *from) {
    uint64_t bits = get(from, 8);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

static void tell(int kind, const double *values, int count) {
    unsigned char out[8 + MOST + 2] = {0xAA, 0x55, (unsigned char)kind, (unsigned char)(8 * count + 1)};
    put(out + 4, number++, 4);
    for (int k = 0; k < count; k++)
        put_double(out + 8 + 8 * k, values[k]);
    out[8 + 8 * count] = 1;
    int end = 8 + 8 * count + 1;
    put(out + end, crc16(0xFFFF, out + 2, end - 2), 2);
    for (int done = 0; done < end + 2;) {
        ssize_t sent = send(line, out + done, (size_t)(end + 2 - done), MSG_NOSIGNAL);
        if (sent <= 0)
            stop("the server has closed the connection");
        done += (int)sent;
    }
}

static void take(unsigned char *to, int size) {
    static unsigned char held[1 << 16];
    static ssize_t have, used;
    for (int k = 0; k < size; k++) {
        if (used == have) {
            used = 0;
            have = recv(line, held, sizeof held, 0);
            if (have <= 0)
                stop("the server has closed the connection");
        }
        to[k] = held[used++];
    }
}

static Message hear(void) {
    Message one;
    unsigned char head[8], sum[2];
    take(head, 8);
    if (head[0] != 0xAA || head[1] != 0x55)
        stop("what came is no message");
    one.kind = head[2];
    one.size = head[3];
    take(one.payload, one.size);
    take(sum, 2);
    if (crc16(crc16(0xFFFF, head + 2, 6), one.payload, one.size) != get(sum, 2))
        stop("a message came whose checksum is wrong");
    for (int k = 0; k < one.size / 8; k++)
        one.value[k] = get_double(one.payload + 8 * k);
    one.valid = one.size && one.payload[one.size - 1] == 1;
    return one;
}

static void end(const Message *last) {
    printf("%.*s\n", last->size - 1, (const char *)last->payload);
    exit(last->valid ? 0 : 1);
}

/* --- a filter */

#define RATE 7.292115e-5 /* of the Earth [rad/s] */
#define AXIS 6378137.0   /* WGS 84 [m] */
#define E2 6.69437999014e-3

static double lla[3], vel[3], q[4], lever[3]; /* q turns forward, right, down into north, east, down */

static void turn(const double v[3], double out[3]) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    out[0] = (1 - 2 * (y * y + z * z)) * v[0] + 2 * (x * y - w * z) * v[1] + 2 * (x * z + w * y) * v[2];
    out[1] = 2 * (x * y + w * z) * v[0] + (1 - 2 * (x * x + z * z)) * v[1] + 2 * (y * z - w * x) * v[2];
    out[2] = 2 * (x * z - w * y) * v[0] + 2 * (y * z + w * x) * v[1] + (1 - 2 * (x * x + y * y)) * v[2];
}

static void multiply(const double a[4], const double b[4], double out[4]) {
    double c[4] = {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                   a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                   a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                   a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
    double size = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2] + c[3] * c[3]);
    for (int k = 0; k < 4; k++)
        out[k] = c[k] / size;
}

static void small(const double angle[3], double out[4]) {
    out[0] = 1;
    for (int k = 0; k < 3; k++)
        out[1 + k] = angle[k] / 2;
}

static void radii(double *north, double *east) {
    double s = sin(lla[0]), w = 1 - E2 * s * s;
    *north = AXIS * (1 - E2) / (w * sqrt(w)) + lla[2];
    *east = AXIS / sqrt(w) + lla[2];
}

static void propagate(const double *imu) { /* t, dt, three increments of angle and three of velocity */
    double dt = imu[1], step[4], up[3], back[3], north, east;
    radii(&north, &east);
    double rate[3] = {RATE * cos(lla[0]) + vel[1] / east, -vel[0] / north,
                      -RATE * sin(lla[0]) - vel[1] * tan(lla[0]) / east};
    turn(imu + 5, up);
    small(imu + 2, step);
    multiply(q, step, q);
    for (int k = 0; k < 3; k++)
        back[k] = -rate[k] * dt;
    small(back, step);
    multiply(step, q, q);
    double s = sin(lla[0]);
    double gravity = 9.7803253 * (1 + 0.00193185 * s * s) / sqrt(1 - E2 * s * s) - 3.086e-6 * lla[2];
    for (int k = 0; k < 3; k++)
        vel[k] += up[k] + (k == 2 ? gravity * dt : 0);
    lla[0] += vel[0] * dt / north;
    lla[1] += vel[1] * dt / (east * cos(lla[0]));
    lla[2] -= vel[2] * dt;
}

static void correct(const double *fix, double t) { /* t, place, velocity of the antenna */
    double arm[3], north, east, step[4], since = t - fix[0];
    radii(&north, &east);
    turn(lever, arm);
    double miss[3] = {(fix[1] - lla[0]) * north - arm[0] + fix[4] * since,
                      (fix[2] - lla[1]) * east * cos(lla[0]) - arm[1] + fix[5] * since,
                      -(fix[3] - lla[2]) - arm[2] + fix[6] * since};
    double wrong[3] = {fix[4] - vel[0], fix[5] - vel[1], fix[6] - vel[2]};
    double tilt[3] = {0.05 * wrong[1] / 9.8, -0.05 * wrong[0] / 9.8, 0};
    small(tilt, step);
    multiply(step, q, q);
    for (int k = 0; k < 3; k++)
        vel[k] += 0.3 * wrong[k];
    lla[0] += 0.2 * miss[0] / north;
    lla[1] += 0.2 * miss[1] / (east * cos(lla[0]));
    lla[2] -= 0.2 * miss[2];
}

int main(int count, char **words) {
    if (count < 2)
        stop("give the port of bench serve");
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(words[1]))};
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    line = socket(AF_INET, SOCK_STREAM, 0);
    if (line < 0 || connect(line, (struct sockaddr *)&at, sizeof at))
        stop("there is no server at this port");
    int yes = 1, steers = count > 2 && !strcmp(words[2], "commands");
    setsockopt(line, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);

    double version = VERSION, unknown = strtod("nan", NULL), height = 0, now = 0;
    tell(HELLO, &version, 1);
    for (;;) {
        Message one = hear();
        const double *v = one.value;
        if (one.kind == END)
            end(&one);
        else if (one.kind == HELLO)
            memcpy(lever, v + 4, sizeof lever);
        else if (one.kind == START) {
            if (!one.valid)
                stop("the start is not told, and this client cannot find it");
            memcpy(lla, v + 1, sizeof lla);
            memcpy(vel, v + 4, sizeof vel);
            memcpy(q, v + 7, sizeof q);
            height = lla[2];
        } else if (one.kind == IMU) {
            now = v[0];
            if (one.valid)
                propagate(v);
        } else if (one.kind == FIX && one.valid)
            correct(v, now);
        else if (one.kind == TURN) {
            double said[26] = {v[0], lla[0], lla[1], lla[2], vel[0], vel[1], vel[2], q[0], q[1], q[2], q[3]};
            for (int k = 11; k < 26; k++) /* no biases; sd of position, velocity, tilt and heading */
                said[k] = k < 17 ? unknown : k < 20 ? 3 : k < 23 ? 0.3 : k < 25 ? 0.02 : 0.05;
            tell(ESTIMATE, said, 26);
            if (steers) {
                double low = height - lla[2], pitch = 0.05 + 0.01 * low + 0.02 * vel[2];
                double throttle = fmin(fmax(0.6 + 0.02 * low, 0), 1);
                double wanted[4] = {v[0], 0.2, fmin(fmax(pitch, -0.2), 0.2), throttle};
                tell(ATTITUDE, wanted, 4);
            }
            tell(DONE, v, 1);
        }
    }
}
