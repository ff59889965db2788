// A load cell that sends palpate's three kinds of lines (see robot_io/drivers/serial_force/microcontroller_cell.py).
// For any Arduino-like board with USB serial, and an HX711 or a NAU7802 (SparkFun, Adafruit ...). No library is needed.
// Choose the converter, upload, and open the port at any baud rate if the board has native USB, otherwise at 115200.

#define NAU7802 1  // 320 samples/s on I2C (SDA, SCL); 0: HX711 on DOUT and SCK, 80 samples/s with its RATE pin high

#include <Arduino.h>
#if NAU7802
#include <Wire.h>
const uint8_t ADDRESS = 0x2A;
const char* const CHIP = "nau7802 320";
#else
const int DOUT = 2, SCK_PIN = 3;
const char* const CHIP = "hx711 80";
#endif

uint16_t crc_of(const char* text) {  // CRC-16/CCITT, from FFFF
  uint16_t crc = 0xFFFF;
  while (*text) {
    crc ^= (uint16_t)(uint8_t)*text++ << 8;
    for (int bit = 0; bit < 8; ++bit) crc = crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1;
  }
  return crc;
}

void send_line(const char* text) {
  char end[8];
  snprintf(end, sizeof end, "*%04X\n", crc_of(text));
  Serial.print(text);
  Serial.print(end);
}

#if NAU7802
bool write_register(uint8_t place, uint8_t value) {
  Wire.beginTransmission(ADDRESS);
  Wire.write(place);
  Wire.write(value);
  return Wire.endTransmission() == 0;
}

int read_bytes(uint8_t place, uint8_t* bytes, uint8_t count) {
  Wire.beginTransmission(ADDRESS);
  Wire.write(place);
  if (Wire.endTransmission(false) != 0 || Wire.requestFrom(ADDRESS, count) != count) return -1;
  for (uint8_t i = 0; i < count; ++i) bytes[i] = Wire.read();
  return count;
}

bool start_converter() {
  Wire.begin();
  Wire.setClock(400000);
  bool good = write_register(0x00, 0x01);  // reset
  good &= write_register(0x00, 0x02);      // digital part on
  delay(1);
  good &= write_register(0x00, 0x86);  // analog part on, supplied by its own regulator,
  good &= write_register(0x01, 0x2F);  // at 3.0 V; gain 128
  good &= write_register(0x02, 0x70);  // 320 samples/s
  good &= write_register(0x15, 0x30);  // clock of the chopper off
  good &= write_register(0x1C, 0x80);  // the second channel's pins carry a capacitor
  delay(600);                          // until the regulator has settled
  good &= write_register(0x00, 0x96);  // conversions begin
  return good;
}

int read_counts(long* counts) {  // 1: a sample, 0: none yet, -1: the converter does not answer
  uint8_t state, bytes[3];
  if (read_bytes(0x00, &state, 1) < 0) return -1;
  if (!(state & 0x20)) return 0;
  if (read_bytes(0x12, bytes, 3) < 0) return -1;
  *counts = (long)((uint32_t)bytes[0] << 16 | (uint32_t)bytes[1] << 8 | bytes[2]);
  if (*counts & 0x800000L) *counts -= 0x1000000L;
  return 1;
}
#else
bool start_converter() {
  pinMode(DOUT, INPUT);
  pinMode(SCK_PIN, OUTPUT);
  digitalWrite(SCK_PIN, LOW);
  return true;
}

int read_counts(long* counts) {
  if (digitalRead(DOUT)) return 0;
  uint32_t bits = 0;
  noInterrupts();  // SCK high for 60 us would switch the HX711 off
  for (int pulse = 0; pulse < 25; ++pulse) {  // the 25th chooses channel A, gain 128
    digitalWrite(SCK_PIN, HIGH);
    delayMicroseconds(1);
    if (pulse < 24) bits = bits << 1 | (digitalRead(DOUT) ? 1 : 0);
    digitalWrite(SCK_PIN, LOW);
    delayMicroseconds(1);
  }
  interrupts();
  *counts = (long)bits;
  if (*counts & 0x800000L) *counts -= 0x1000000L;
  return 1;
}
#endif

uint8_t counter = 0;
unsigned long last_ms = 0;
bool started = false;

void setup() {
  Serial.begin(115200);
  started = start_converter();
}

void loop() {
  char text[32];
  while (Serial.available()) {
    if (Serial.read() != '?') continue;
    snprintf(text, sizeof text, "cell 1 %s", CHIP);
    send_line(text);
  }
  long counts;
  int found = started ? read_counts(&counts) : -1;
  if (found > 0) {
    snprintf(text, sizeof text, "%u %ld", (unsigned)++counter, counts);
    send_line(text);
    last_ms = millis();
  } else if (millis() - last_ms > 100) {  // ten times per second, until the host reads
    send_line(found < 0 ? "fault converter" : "fault silent");
    last_ms = millis();
    started = started && found == 0 ? true : start_converter();
  }
}
